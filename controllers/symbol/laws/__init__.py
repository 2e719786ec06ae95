"""Feedback laws without heights of the road, and the stages around them."""
