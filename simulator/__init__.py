"""The twin of the rig: the same wires, lit by Mitsuba."""
