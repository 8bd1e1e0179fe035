"""What pages draw from binary messages: the 3D scene, camera tiles and running plots. `messages` has the layout."""
