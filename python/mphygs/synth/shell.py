def simulate_shell(*a, **k):
    raise RuntimeError
