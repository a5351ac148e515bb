"""The Robot endpoint: robots' WebSockets on one side, data links on the other, conversion between them."""
