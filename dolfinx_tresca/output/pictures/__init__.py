"""The parts of a picture: the bodies, and a view or a chart of each contact surface."""
