"""The equations of motion at one state, and their solution."""
