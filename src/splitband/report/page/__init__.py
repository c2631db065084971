"""Write results as one HTML file to look at and send on: it loads nothing from elsewhere."""

NAME = "report.html"
"""Name of the page's file in the folder of a result."""
