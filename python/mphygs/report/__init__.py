"""What was found, to look at: one self-contained page with a turning view of the motion."""
