"""Access control: users, keys, tokens, rights, and the audit log of what was done with them."""
