"""Before any fit: what stands in the way, and what can be told."""

import json
import subprocess
import sys
import tempfile

import bar

import mphygs


def main() -> dict[str, object]:
    """`mphygs doctor FOLDER --json`."""
    with tempfile.TemporaryDirectory() as folder:
        mphygs.save_capture(bar.make(), folder)
        line = [sys.executable, "-m", "mphygs.doctor", folder, "--effects", "viscosity", "--json"]
        told = json.loads(subprocess.run(line, check=True, capture_output=True, text=True).stdout)
    for finding in told["findings"] or ["nothing in the way"]:
        print("-", finding)
    for key, entry in told["parameters"].items():
        print(f"{key}: {entry['value']:.4g} +- {entry['std']:.2g} {entry['unit']}, expected")
    return told


if __name__ == "__main__":
    main()
