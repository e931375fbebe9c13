"""What `run.py` is made of: the plan, its runs on this machine or a cluster, and what one sees of them."""
