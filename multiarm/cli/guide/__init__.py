"""Joints as their users think of them: pictures, free motions, limits, and how to write them.

``words`` has what must be said by people; ``cards`` reads all else off the schema and the contact
records; ``motions`` and ``limits`` judge the joints of a compiled scene.
"""
