"""The person on the bench: bodies and postures, the scene round them, what is read of them."""
