"""mphygs: recover what a soft object is made of from how it moves, and say which physics is missing."""
