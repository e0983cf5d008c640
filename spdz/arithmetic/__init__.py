"""Numbers: the field, exact products, public bounds, fixed point, public numbers, pseudo-random bytes."""
