"""The bug family: what a bug sees, its motions, and one file per bug."""
