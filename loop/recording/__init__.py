"""What a run leaves: manifest, recording, summary, video."""
