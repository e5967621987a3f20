"""Optional effects: each file one effect; a scene runs only those that it names.

``multiarm/effects/<name>.py`` holds what ``effects: {<name>: ...}`` of a scene adds to the model:
its equation, its compiled kernel, and ``build(spec, site)``, which returns the pieces that the
evaluation calls (:mod:`multiarm.effects.piece`).  What a scene does not name is not imported, has
no array, and is not called.
"""
