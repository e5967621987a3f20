"""Optional effects: each file one effect; a scene runs only those that it names.

A compiled scene holds a program, a list of ``(code, offset)`` pairs.  An effect that is not named
is not in it: no branch, no array, no parameter.
"""
