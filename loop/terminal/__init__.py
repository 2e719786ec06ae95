"""What the terminal shows: tables, progress, lists, and the state of an installation."""
