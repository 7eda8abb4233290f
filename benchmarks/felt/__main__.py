"""Parts of the benchmark of felt stiffness: python -m benchmarks.felt PART; each prints its figures."""

import sys

from benchmarks.felt import allocation

PARTS = {"allocation": allocation.report}


def main(names: list[str]) -> None:
    if len(names) != 1 or names[0] not in PARTS:
        sys.exit(f"usage: python -m benchmarks.felt {{{','.join(PARTS)}}}")
    print(PARTS[names[0]]())


if __name__ == "__main__":
    main(sys.argv[1:])
