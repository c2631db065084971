"""Write results as JSON, tables, pictures and a page."""
