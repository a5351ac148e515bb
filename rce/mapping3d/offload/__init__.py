"""A map in the cloud of robots that track themselves: key frames go up, corrected poses come back.

This is the division of labour of the Rapyuta paper (Mohanarajah et al., Cloud-Based Collaborative 3D Mapping in
Real-Time With Low-Cost Robots, 2015) and of C2TAM (Riazuelo, Civera and Montiel, 2014).

- `messages`: key frames as they travel.
- `outbox`: key frames that the cloud does not have yet.
- `follower`: a pose that follows corrections without jumps.
- `tracking`: the robot's side: tracks frames, and applies corrections.
- `shared_map`: the cloud's side: the maps of all robots, corrections, and the dense maps.
- `sending`: when which key frame is sent.
- `client`: the robot's side at a platform; it needs no ROS.
- `streams`, `streaming`: all frames go up instead, compressed, and the cloud tracks.
- `sessions`: saved maps.
- `runs`: recordings, mapped through a platform.
"""
