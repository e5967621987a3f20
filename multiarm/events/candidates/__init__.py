"""What may come and go in a scene: contacts that let go, joints at limits, dry friction.

Named here are the *units* and the rows that they have; what becomes of them in time is the business
of :mod:`multiarm.events`.
"""
