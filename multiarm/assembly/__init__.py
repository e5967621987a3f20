"""Assembling: bringing what is written onto the joints, with the least change.

`start` puts positions and velocities on the constraints and reports what was changed; `linkage`
holds the gaps as a function of what may move, `closing` closes them, `velocities` their rates,
`refusals` says why it cannot be done, and `paths` moves the arms with a given object.
"""
