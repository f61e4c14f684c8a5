"""The ladder: one scene under several models of its liquid, cheapest first, and the choice among them."""
