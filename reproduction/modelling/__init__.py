"""Chapter 7: learned inverse kinematics and dynamics, beside Tables 7.4 and 7.5, and in use."""
