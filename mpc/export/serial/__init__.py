"""Export of the firmware of a board on a serial line: a terminal, or the whole controller.

    export_board("board_in_c")                                            takes commands
    export_board("board_in_c", controller=TrackingMPC(plant, N=10))       takes references

`docs/serial.md` explains the line protocol. `mpc/export/c/serial/` is exported unchanged, and
`simulated.SimulatedBoard` compiles it for the PC, with a simulated joint.
"""
