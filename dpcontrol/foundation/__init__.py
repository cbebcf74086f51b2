"""What every package stands on: errors, files written whole, checked TOML tables."""
