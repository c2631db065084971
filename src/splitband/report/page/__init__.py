"""Write results as one HTML file to look at and send on: it loads nothing from elsewhere."""

NAME = "report.html"
"""Of the file beside other results."""
