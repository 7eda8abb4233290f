"""Write allocator and controller as C for a microcontroller into a new directory."""

from tempfile import mkdtemp

from allocator import named_muscle, report_joint
from mpc import Plant, TrackingMPC
from mpc.export import export

plant = Plant(joint=report_joint(named_muscle("sarosi-dmsp-20-400n")))
made = export(mkdtemp(), controller=TrackingMPC(plant, N=10), precision="single")
print(f"written to {made}: {', '.join(sorted(file.name for file in made.iterdir()))}")
