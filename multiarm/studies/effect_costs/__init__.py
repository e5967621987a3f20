"""The cost of each effect of a scene, and the changes that it makes: the ledger.

A scene is run once more without each of its effects (and with each further one), to the requested
accuracy.  The ledger lists times and changes of the motion; an effect whose changes stay below the
accuracy can be left out.  What an effect adds to one evaluation is measured too.
"""
