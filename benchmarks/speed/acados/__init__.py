"""acados as a rival, and the QP alone against HPIPM, the QP solver of acados.

rti (a step of acados's real-time iteration)
recorded (QPs of closed loops) → stages (the same QP as HPIPM takes it) → library (HPIPM by its C interface) → alone

Libraries, headers and `t_renderer` of acados are searched in `$ACADOS_SOURCE_DIR`, as acados does, and
`acados_template` on the path; their absence is reported in the rows. One wheel contains them all; it is unpacked, not
installed, because it includes its own CasADi:

    pip download --no-deps comma-deps-acados && unzip -q comma_deps_acados-*.whl && cd comma_deps_acados-*/purelib
    export ACADOS_SOURCE_DIR=$PWD/acados/install PYTHONPATH=$PWD/acados
"""
