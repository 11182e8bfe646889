"""One-way paths between the radar and a point, straight or over large flat surfaces."""
