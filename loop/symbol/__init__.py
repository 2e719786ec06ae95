"""The loop that holds a symbol: its plant, what is true of it, its steps, one by one or as a batch."""
