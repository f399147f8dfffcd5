"""Chapter 7: learned inverse kinematics and dynamics, compared with Tables 7.4 and 7.5."""
