"""Tables of the database. A change here needs a revision in `migrations/versions`."""

from __future__ import annotations

import sqlalchemy as sa

tables = sa.MetaData()


records = sa.Table(
    "records",
    tables,
    sa.Column("kind", sa.String(32), primary_key=True),
    sa.Column("key", sa.String(1600), primary_key=True),  # of a connection: six names of 255
    sa.Column("value", sa.Text, nullable=False),
)
users = sa.Table(
    "users",
    tables,
    sa.Column("name", sa.String(255), primary_key=True),
    sa.Column("password", sa.Text, nullable=False),  # argon2 of the SHA-256 hex
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("created", sa.Float, nullable=False),
)
api_keys = sa.Table(
    "api_keys",
    tables,
    sa.Column("digest", sa.String(64), primary_key=True),  # SHA-256 of the key
    sa.Column("id", sa.String(32), unique=True, nullable=False),
    sa.Column("user", sa.String(255), sa.ForeignKey("users.name", ondelete="CASCADE"), index=True, nullable=False),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("label", sa.Text, nullable=False),
    sa.Column("created", sa.Float, nullable=False),
    sa.Column("expires", sa.Float),
    sa.Column("used", sa.Float),
    sa.Column("scopes", sa.Text),  # JSON; null: not narrowed
    sa.Column(
        "parent", sa.String(32), sa.ForeignKey("api_keys.id", ondelete="CASCADE"), index=True
    ),  # the key with which it was made; null: made with a password
)
# Limits of users who do not have those of the platform; the running Master stores the platform's at user "".
limits = sa.Table(
    "limits",
    tables,
    sa.Column("user", sa.String(255), primary_key=True),
    sa.Column("value", sa.Text, nullable=False),
)
# Rights of services to act for users; removed with the user, or with the API key with which they were given.
grants = sa.Table(
    "grants",
    tables,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("service", sa.String(600), nullable=False),
    sa.Column("user", sa.String(255), sa.ForeignKey("users.name", ondelete="CASCADE"), index=True, nullable=False),
    sa.Column(
        "key", sa.String(32), sa.ForeignKey("api_keys.id", ondelete="CASCADE"), index=True
    ),  # null: given with a password
    sa.Column("created", sa.Float, nullable=False),
    sa.Column("lent", sa.String(64), unique=True),  # SHA-256 of the temporary key of the service
    sa.Column("expires", sa.Float),  # of the temporary key
)
# Credentials that processes got for their join tokens.
credentials = sa.Table(
    "credentials",
    tables,
    sa.Column("process", sa.String(600), primary_key=True),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("digest", sa.String(64), nullable=False),
)
# One-time join tokens; used ones stay, so that they cannot be added again.
tokens = sa.Table(
    "tokens",
    tables,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("process", sa.String(600), index=True, nullable=False),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("used", sa.Boolean, nullable=False),
    sa.Column(
        "key", sa.String(32), sa.ForeignKey("api_keys.id", ondelete="CASCADE"), index=True
    ),  # with which a machine was invited; null: with a password
    sa.Column("public_key", sa.String(64)),  # SHA-256 of the machine's key that got a certificate for an invitation
)
# When machines were removed, in seconds since 1970: their certificates from before are refused.
removed_machines = sa.Table(
    "removed_machines",
    tables,
    sa.Column("name", sa.String(600), primary_key=True),
    sa.Column("time", sa.Float, nullable=False),
)
# When users were removed, in seconds since 1970: processes remove what they keep of them.
removed_users = sa.Table(
    "removed_users",
    tables,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("time", sa.Float, nullable=False),
)
# Rows are added, and removed when they are too old; none is changed.
audit = sa.Table(
    "audit",
    tables,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("time", sa.Float, index=True, nullable=False),
    sa.Column("user", sa.String(255), index=True, nullable=False),
    sa.Column("key", sa.String(32), nullable=False),
    sa.Column("owner", sa.String(255), index=True, nullable=False),
    sa.Column("action", sa.String(64), nullable=False),
    sa.Column("object", sa.Text, nullable=False),
    sa.Column("result", sa.String(64), nullable=False),
    sa.Column("door", sa.String(16), nullable=False),
    sa.Column("address", sa.String(64), nullable=False),
)
# The Master that leads, of several with one PostgreSQL database: one row. Backups have neither this nor the next table.
leader = sa.Table(
    "leader",
    tables,
    sa.Column("id", sa.Integer, primary_key=True),  # always 1
    # Unique, so that PostgreSQL takes a change of the term for one of a key, and a renewal not: transactions share a
    # lock of the key, for which a change of the term waits and a renewal does not.
    sa.Column("term", sa.BigInteger, unique=True, nullable=False),
    sa.Column("holder", sa.String(64), nullable=False),  # identity of the Master's data directory
    sa.Column("url", sa.Text, nullable=False),  # of its entry
    sa.Column("until", sa.DateTime(timezone=True), nullable=False),  # by the clock of the database
)
# Archives of users' packages, with PostgreSQL only: parts of them by their numbers.
archives = sa.Table(
    "archives",
    tables,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("part", sa.Integer, primary_key=True),
    sa.Column("data", sa.LargeBinary, nullable=False),
)
