"""People found in rendered pictures, beside BlazePose."""
