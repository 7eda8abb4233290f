"""The bench is where a controller meets hardware: devices, the real-time loop, its safety and its log."""
