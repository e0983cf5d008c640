"""Secret values as programs see them, what they refuse, input masks, and what engines and gates are."""
