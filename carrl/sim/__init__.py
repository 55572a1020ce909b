"""The batched 2D wall-and-ray simulator: pure torch, tensors in and tensors out."""
