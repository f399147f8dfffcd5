"""The accuracy and speed of the pose network, compared with BlazePose."""
