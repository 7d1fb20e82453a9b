in float height;
out float nearness;

void main() {
    float away = 1.0 - clamp(height, 0.0, 1.0);
    nearness = away * away;
}
