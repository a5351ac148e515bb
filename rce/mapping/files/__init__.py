"""Files of mapping: recordings to read; maps, pictures and saved sessions to write and read.

File formats belong here, and no mapping.
"""
