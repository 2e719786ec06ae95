"""The studio: a page in the browser that shows and steers a running loop."""
