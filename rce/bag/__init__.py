"""Recordings of topics: MCAP files with the definitions of their types, as rosbag2 and viewers read them."""
