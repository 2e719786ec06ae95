"""The socket at which another simulator is the plant, and its messages (docs/remote.md). Without torch."""
