"""Drawing a symbol, and measuring it in camera frames."""
