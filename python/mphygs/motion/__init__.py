"""What the videos say moved: registration to frame 0, tracks, the motion of the contact."""
