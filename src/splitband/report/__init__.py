"""Results as JSON and tables, and pictures of them."""
