"""What others do, on this simulator: what a benchmark stands beside."""
