"""What the loop runs on: exposures in, frames and sensor samples out."""
