"""The HTTP API of the Master, under `/api/v1/`: JSON in and out, errors as problem+json (RFC 9457)."""
