"""Cameras that this computer speaks to; one that only drops files into a folder needs none of these."""
