"""Files of a run: manifest, trajectory, summary, frames, labels and video; and their replay."""
