"""Check fitted forecasters: residual tests, stability, responses to steps."""
