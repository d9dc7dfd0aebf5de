"""From plan to verified frames on disk, and from frames to radiance."""
