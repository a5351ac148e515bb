"""The Master: what users want, what there is, and the effects that close the gap. Never on the data path."""
