"""Open benchmark on measurements of real muscles, a real joint and a real arm."""
