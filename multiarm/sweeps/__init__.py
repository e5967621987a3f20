"""Sweeps: one scene, hundreds or thousands of runs, one file.

scene + sweep file -> plan -> jobs -> executor -> records -> one file
"""
