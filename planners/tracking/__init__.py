"""Moving obstacles: found in the scans, followed and predicted."""
