"""Images and rasters of others: what their headers say, and their pixels."""
