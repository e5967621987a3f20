"""What each effect of a scene costs, and what it changes: the ledger.

A scene is run once more without each effect that it names (and with each that it might name), to
the accuracy that it asks for.  Beside the time stands what is moved by it; what stays below the
accuracy can be left out.  *An evaluation* is looked at by itself too: what an effect adds to it.
"""
