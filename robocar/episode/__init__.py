"""Episodes: the loop, runs and replays, their files, and the registry of parts."""
