"""What experiments write and the terminal shows."""
