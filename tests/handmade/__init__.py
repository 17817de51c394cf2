"""Results folders that no flight wrote, and what is read of them."""
