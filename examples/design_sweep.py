"""Compare designs of a joint on all processors: how far it turns, and which stiffness it keeps all the way.

On a Dask cluster: `executor=distributed.Client("address").get_executor()`.
"""

from concurrent.futures import ProcessPoolExecutor

from allocator import DEG, named_muscle
from allocator.feasibility import design_grid, design_sweep


def main():
    designs = design_grid(radius=(0.015, 0.02, 0.03), rest_length=(0.3, 0.4), initial_contraction=(0.10, 0.14))
    muscle = named_muscle("sarosi-dmsp-20-400n")
    with ProcessPoolExecutor(2) as pool:
        sweep = design_sweep(designs, muscle=muscle, stops=(-90 * DEG, 90 * DEG), executor=pool)
    for design, found in sorted(zip(sweep.designs, sweep.performances, strict=True), key=lambda row: -row[1].range):
        lengths = f"R {1000 * design.radius:.0f} mm, L {1000 * design.rest_length:.0f} mm"
        print(f"{lengths}, ε0 {design.initial_contraction:g}: {found.range / DEG:.0f}°")


if __name__ == "__main__":
    main()
