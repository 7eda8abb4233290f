"""Many closed loops run here in compiled code: the plant under test, the controller's sample and the loop of both."""
