"""Export of plants and controllers as FMUs: FMI 3.0, co-simulation in samples, as source and compiled.

    export_plant_fmu("plant.fmu", RealPlant.standard(), dt=0.01)
    export_controller_fmu("controller.fmu", TrackingMPC(plant, N=10))

The C is that of `mpc.export` and `mpc.export.plant`. `mpc/export/c/fmu/` wraps it in the functions of FMI, and
`mpc/export/c/fmi3/` holds the unchanged headers of the standard (2-clause BSD).
"""
