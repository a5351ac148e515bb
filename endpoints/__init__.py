"""Endpoints: the two ends of every data path, at robots (`robot`) and in environments (`environment`)."""
