"""The files of the page, and the helper processes of the API."""
