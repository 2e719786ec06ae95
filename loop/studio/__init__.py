"""The studio: a page in the browser that watches and steers a loop while it runs."""
