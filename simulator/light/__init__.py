"""What the camera sees of the lamp's light: which paths exist, and the cheapest method that covers them."""
