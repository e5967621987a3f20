"""Sweeps: one scene, hundreds or thousands of runs, one folder.

scene + sweep file -> plan -> run, on workers -> rows -> folder -> table
"""
