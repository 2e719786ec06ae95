"""The socket at which another simulator is the plant, and its messages (docs/programs.md). Without torch."""
