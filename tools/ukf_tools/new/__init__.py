"""Projects of one's own to start from: `ukf new`."""
