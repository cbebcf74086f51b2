"""The MCAP log: message layout, writer, reader."""
