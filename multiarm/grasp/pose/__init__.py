"""The body's frame from the positions of the fingertips (thesis, 2.4; appendix B)."""
