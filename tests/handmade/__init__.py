"""Results folders that no flight wrote, and helpers to read them."""
