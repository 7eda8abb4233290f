"""Export of plants and controllers as FMUs: FMI 3.0, co-simulation in samples, as source and compiled.

    export_plant_fmu("plant.fmu", RealPlant.standard(), dt=0.01)
    export_controller_fmu("controller.fmu", TrackingMPC(plant, N=10))

The C is that of `mpc.export` and `mpc.export.plant`; `mpc/export/c/fmu/` puts the functions of FMI around it, and
`mpc/export/c/fmi3/` are the standard's own headers (2-clause BSD), as they are.
"""
