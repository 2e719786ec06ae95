"""Labels beside the frames of a recording, for programs that learn from them: docs/data.md."""
