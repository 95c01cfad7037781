"""The commands: options, frame, progress and claims. Nothing else parses, prints or exits."""
