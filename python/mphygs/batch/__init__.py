"""One command over many folders: runs side by side on workers, and one table of what came of them."""
