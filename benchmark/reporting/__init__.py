"""What reads results: the paper's and ours as tables, figures and claims, of which `report.py` makes a page."""
