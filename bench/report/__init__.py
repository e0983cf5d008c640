"""``python -m bench report``: a results folder as the paper's table, ratios, floors, and plots.

``folder.py`` reads and checks the folder; each part of the report is a file (``paper.py``, ``ratios.py``,
``floor.py``, ``gallery.py``, ``phases.py``) that gives tables; ``plots.py`` draws; ``page.py`` and
``markdown.py`` write the same sections.
"""
