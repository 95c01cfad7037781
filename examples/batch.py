"""Many recordings: every one fitted, what was found in one table."""

import bar

import mphygs


def main(stiffnesses: tuple[float, ...] = (1e5, 2.5e5, 6e5)) -> list[dict[str, object]]:
    """One row a recording; `pandas.DataFrame(rows)` is the table."""
    rows = []
    for number, truth in enumerate(stiffnesses):
        found = mphygs.fit(bar.make(truth, seed=number), effects="viscosity", spacing=0.006)
        row = {"recording": number, "truth": truth}
        row |= {key: number.value for key, number in found.parameters.items()}
        row["unseen"] = found.sequences["swing"]["predict"].rms_over_sigma
        rows.append(row)
        print(row)
    return rows


if __name__ == "__main__":
    main()
