"""Sweeps: one scene, hundreds or thousands of runs, planned, carried out and kept.

scene + sweep file -> plan -> runs, pure functions of (scene, values) -> rows, in one file
"""
