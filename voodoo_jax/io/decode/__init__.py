"""Messages of a log decoded: one module for each kind of content, and the table of all message types."""
