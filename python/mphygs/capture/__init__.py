"""What was measured: capture folders, markers, holds, loads."""
