"""What a run leaves: manifest, recording, summary, report, video; and how it is replayed."""
