"""The front door: the command line. Composes the rooms; holds no physics."""
