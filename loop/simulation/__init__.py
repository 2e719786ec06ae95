"""The stepped loop and its parts: lamps, symbols, plants, and how they are built from a scenario."""
