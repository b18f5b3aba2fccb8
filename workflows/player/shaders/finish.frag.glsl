// What was blended, before the scene's background.
uniform highp sampler2D uBlended;
uniform vec3 uBackground;
out highp vec4 oColour;

void main() {
    vec4 blended = texelFetch(uBlended, ivec2(gl_FragCoord.xy), 0);
    oColour = vec4(clamp(blended.rgb + blended.a * uBackground, 0.0, 1.0), 1.0);
}
