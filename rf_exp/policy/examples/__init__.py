"""Demonstrations as training examples: windows of a store, and the labels of the keypoint encoder."""
