"""What people look at before they print."""
