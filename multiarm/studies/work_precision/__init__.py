"""Work and precision of a scene: what each accuracy costs, by every method, beside other programs.

A *setting* says how a run is done, a *point* what it cost and how wrong it was, a *ladder* is the
settings of one method from coarse to fine.  Errors are those against a reference whose digits are
known, because an independent path through the program arrives at them too.
"""
