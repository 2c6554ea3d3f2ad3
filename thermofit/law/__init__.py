"""The law: what a material is, one scalar function per physical statement, and how effects and hardening laws enter it."""
