"""Work and precision of a scene: the cost of each accuracy by every method, and by other programs.

A *setting* says how a run is done, a *point* is its cost and its error, a *ladder* is the settings
of one method from coarse to fine.  Errors are measured against a reference whose digits are known,
because an independent path through the program arrives at them too.
"""
