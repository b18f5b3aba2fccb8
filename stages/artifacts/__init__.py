"""What stages exchange, as typed readers and writers."""
