"""Many closed loops in compiled code: the plant under test, the controller's sample, and their loop."""
