"""Files: recordings of cameras in, trajectories and saved sessions out."""
